"""Tables as data, in every form that is printed or written."""
