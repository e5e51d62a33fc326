"""View an episode in a web page, live or recorded.

`Recorder` records what a viewer shows of an episode. `packing` converts it to bytes for the browser, `viewer_page`
makes the page that draws it, and `LiveView` serves the page during an episode. Shown are the agent's map, planes,
candidates and images; no ground truth.
"""

from activestructure_gym.viewer.live import LiveView
from activestructure_gym.viewer.packing import film_parts, packed
from activestructure_gym.viewer.page import viewer_page
from activestructure_gym.viewer.recorder import Film, Moment, Recorder

__all__ = ["Film", "LiveView", "Moment", "Recorder", "film_parts", "packed", "viewer_page"]
