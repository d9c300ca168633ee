"""Tables and pages made from the runs' own files."""
