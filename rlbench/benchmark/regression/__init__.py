"""The regression check: results against a baseline, with the fall that each cell is allowed.

`baseline` reads and writes the expected scores, `update` makes them from results, `comparison`
judges each cell, and `speed_gate` the ratio of two times. `junit` and `page` write what was found,
and `crops` the images of the worst change.
"""
