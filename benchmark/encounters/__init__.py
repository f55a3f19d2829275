"""What an ego and the others around it do to one another: tracks in continuous time, paths, sight, contacts."""
