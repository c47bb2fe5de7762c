"""Which rows a report of images shows, and in which order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from reports.viewer.pictures import ShownClip, ShownImages
from rlbench.benchmark.results import MissingRowsError

__all__ = ["first_of_scenes", "select_images"]


def select_images(
    clip: ShownClip, methods: Sequence[str], usual: Sequence[str], at_least: int, at_most: int
) -> list[ShownImages]:
    """The images of a clip: `methods` in their order, or without them `usual`, then the others.

    Raises MissingRowsError for a method without images, and where there are fewer than `at_least`.
    """
    images = {each.method: each for each in clip.images}
    available = ", ".join(images)
    if missing := [name for name in methods if name not in images]:
        raise MissingRowsError(
            f"no images of {', '.join(missing)} on {clip.name}; there are: {available}. Run the "
            "method with --keep-images at this budget"
        )
    order = list(methods) or [name for name in usual if name in images]
    order += [] if methods else [name for name in images if name not in order]
    if len(order) < at_least:
        raise MissingRowsError(
            f"{at_least} methods with images are compared; {clip.name} has {available}. Repeat "
            "`rlbench run --keep-images` with more methods"
        )
    return [images[name] for name in order[:at_most]]


def first_of_scenes(clips: Iterable[ShownClip], at_most: int) -> Iterator[ShownClip]:
    """The first clip of each scene, of the first `at_most` scenes."""
    scenes: set[str] = set()
    for clip in clips:
        if clip.scene not in scenes:
            scenes.add(clip.scene)
            yield clip
        if len(scenes) == at_most:
            return
