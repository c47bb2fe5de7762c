"""The results as pages of the documentation: a leaderboard, a page for each method and scene."""

from rlbench.apps.view.site.build import build_pages
from rlbench.apps.view.site.preset_scores import PresetScores, preset_scores

__all__ = ["PresetScores", "build_pages", "preset_scores"]
