"""Test of a trained model under disturbances: what breaks it, and how much it loses."""
