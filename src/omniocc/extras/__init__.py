"""What not everybody needs: recorders, viewer, systems of others, readers of further datasets."""
