"""A finished run to be watched: played again, packed into one page that needs nothing else."""

from activestructure_gym.evaluation.replay.page import replay_page, write_replay
from activestructure_gym.evaluation.replay.recording import Recording, play_again

__all__ = ["Recording", "play_again", "replay_page", "write_replay"]
