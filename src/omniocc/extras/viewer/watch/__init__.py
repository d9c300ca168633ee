"""A page that follows runs in progress, served to this machine alone from the files that the runs write."""
