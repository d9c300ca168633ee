"""What is recorded of one time step: cameras, panorama, LiDARs and labelled points."""
