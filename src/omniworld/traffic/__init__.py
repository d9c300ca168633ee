"""Moving cars and people; `traffic.Traffic` gives all actors and the ego pose at any time.

Cars: fleet (vehicles), lanes (their paths), flow (their motion); people: pedestrians, path.
"""
