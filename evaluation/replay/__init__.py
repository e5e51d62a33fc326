"""Replay a finished run: simulate it again, then write one self-contained page or a video."""

from activestructure_gym.evaluation.replay.page import replay_page, write_replay
from activestructure_gym.evaluation.replay.recording import Recording, play_again
from activestructure_gym.evaluation.replay.video import check_video, write_video

__all__ = ["Recording", "check_video", "play_again", "replay_page", "write_replay", "write_video"]
