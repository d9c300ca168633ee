"""The static town; `place.build(theme, seed)` builds it, and a new theme is an entry in `themes`.

Land: terrain, network (streets), road (surfaces), marking.
On it: street, plot (kinds of plots); place adds islands, medians, railway, hall and backdrop.
"""
