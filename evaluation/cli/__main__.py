"""Run the program ``asg`` when Python is called as ``python -m activestructure_gym.evaluation.cli``."""

import sys

from activestructure_gym.evaluation.cli import main

sys.exit(main())
