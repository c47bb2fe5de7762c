"""Videos of kept images: panels side by side, or two behind a moving divider; MP4 and WebP."""

from rlbench.apps.view.video.style import VideoStyle, check_formats
from rlbench.apps.view.video.write import write

__all__ = ["VideoStyle", "check_formats", "write"]
