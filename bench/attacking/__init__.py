"""The campaign of hostile inputs: small changes of valid files, given to the commands that read such files."""
