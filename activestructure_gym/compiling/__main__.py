"""``python -P -m activestructure_gym.compiling PARENT CALL...`` is a process that compiles ahead."""

import sys

from activestructure_gym.compiling.ahead import main

if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
