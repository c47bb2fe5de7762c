"""Scenes that need no download: four test scenes, and a generator of training scenes.

A scene is data (`rlbench.apps.render.scene`): arrays of triangles, materials, a camera path, and a
function from time to vertices. Nothing here imports a renderer. Lengths are metres, z points up and
time counts frames.

Names of functions say what they return: `build_...` a Shape (triangles without a material),
`..._mesh` a Mesh (with a material), `..._pixels` an image array, `..._texture` and `..._bsdf` a
Mitsuba plugin, and `draw_...` something random from a generator.
"""
