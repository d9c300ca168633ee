"""Variations of a scene that only some options ask for: night, a camera that is late.

Their code is part of the fingerprint of no other data, so that a change here makes nothing else to be rendered anew.
"""
