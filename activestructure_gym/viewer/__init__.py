"""To be looked at: an episode as it happens or as it was, in a page of its own.

`Recorder` keeps what can be watched of an episode, `packing` makes bytes of it that a browser unpacks, `viewer_page` is
the page that draws them, and `LiveView` serves it while an episode goes on. What is shown is what the agent has: the
map, the planes, the candidates, its own images. No ground truth is in here.
"""

from activestructure_gym.viewer.live import LiveView
from activestructure_gym.viewer.packing import film_parts, packed
from activestructure_gym.viewer.page import viewer_page
from activestructure_gym.viewer.recorder import Film, Moment, Recorder

__all__ = ["Film", "LiveView", "Moment", "Recorder", "film_parts", "packed", "viewer_page"]
