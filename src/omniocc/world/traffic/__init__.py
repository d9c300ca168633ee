"""Moving cars and people; `traffic.Traffic` gives all actors and the ego pose at any time.

Cars: fleet (which vehicles), lanes (where they drive), flow (how they react); people: pedestrians, path.
"""
