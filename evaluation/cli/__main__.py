"""``python -m activestructure_gym.evaluation.cli`` is ``asg``."""

import sys

from activestructure_gym.evaluation.cli import main

sys.exit(main())
