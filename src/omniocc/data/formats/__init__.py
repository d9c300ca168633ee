"""Files of public datasets: how their own kits write them. One module for each format; `common` is what they share."""
