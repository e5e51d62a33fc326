"""A finished run to be watched: played again, as one page that needs nothing else, or as a video."""

from activestructure_gym.evaluation.replay.page import replay_page, write_replay
from activestructure_gym.evaluation.replay.recording import Recording, play_again
from activestructure_gym.evaluation.replay.video import check_video, write_video

__all__ = ["Recording", "check_video", "play_again", "replay_page", "write_replay", "write_video"]
