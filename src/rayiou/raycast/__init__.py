"""First hits of rays through labelled grids, on the CPU and on any device."""
