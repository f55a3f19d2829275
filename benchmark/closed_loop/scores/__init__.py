"""What is said of a drive: contact, progress, comfort, the road, and scores of others' formulas; never mixed."""
