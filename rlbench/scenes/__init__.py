"""Scenes that need no download: four to test on, and a generator of others to train on.

A scene is data (rlbench.render.scene): arrays from `shapes`, materials from `textures`, a camera
path and a function from time to vertices. Nothing here imports a renderer. Lengths are metres, z is
up, time counts frames.
"""
