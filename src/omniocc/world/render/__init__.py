"""Ray casting, surfaces, light, weather and camera images."""
