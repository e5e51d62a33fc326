"""Show an episode in a web page, live or recorded.

`Recorder` records the states of an episode. `packing` converts them to bytes for the browser, and `viewer_page` makes
the HTML page that draws them. `LiveView` serves the page during an episode. The page shows the map, planes, candidates
and images of the agent; it contains no ground truth.
"""

from activestructure_gym.viewer.live import LiveView
from activestructure_gym.viewer.packing import film_parts, packed
from activestructure_gym.viewer.page import viewer_page
from activestructure_gym.viewer.recorder import Film, Moment, Recorder

__all__ = ["Film", "LiveView", "Moment", "Recorder", "film_parts", "packed", "viewer_page"]
