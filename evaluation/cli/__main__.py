"""Run ``asg`` by ``python -m activestructure_gym.evaluation.cli``."""

import sys

from activestructure_gym.evaluation.cli import main

sys.exit(main())
