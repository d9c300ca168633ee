"""Record scenes in CARLA as the paper did (section III): cubemaps to fisheyes, 20 semantic LiDARs, votes.

`client` captures in a process of its own; `unreal`, `tags` and `decode` translate what it sends; `sensors` says what
to mount, `frames` makes our frames of raw ones, `recorder` watches over all of it.
"""
