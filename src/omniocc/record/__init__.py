"""Recorders of scenes from outside of the virtual world: a CARLA server, or the logs of a car.

All write the same format (`omniocc.data.store`), which `data=recorded` reads.
"""
