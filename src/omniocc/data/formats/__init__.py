"""Files of public datasets: how their own kits write them, one module for each format, and what these share."""
