"""A clock that can be trusted: interleaved rounds, a calibration kernel, and a test of each time.

`stopwatch` reads the clocks around the parts of a frame, `calibration` measures how busy the
machine is, `rounds` interleaves the rows, and `reliability` decides which times may be believed.
"""
