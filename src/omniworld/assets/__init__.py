"""Things to furnish a town with; to add one, write a builder and enter it into `KINDS` of its file.

Groups: barrier, building, person, pole, prop, tree, vehicle; `catalog` builds the variants of each kind once.
"""
