"""Moving cars and people; `traffic.Traffic` gives all actors and the ego pose at any time.

`lanes` are the paths of cars, `flow` is their motion; `traffic` draws vehicles and people and moves them.
"""
