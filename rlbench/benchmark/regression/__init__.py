"""The regression check: results against a baseline, with the fall that each cell is allowed.

`baseline` reads the expected scores and makes them from results, `comparison` judges each cell and
the ratio of two times. `pages` writes what was found, and `crops` the images of the worst change.
"""
