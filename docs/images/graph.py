"""Make docs/images/graph.webp, the Plane Scene Graph of README, from a run of `activestructure` (benchmark.csv).

    python docs/images/graph.py runs/benchmark

The image has the view from the north-west and the legend of the run's ``psg_3d.png``.
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

OUT = Path(__file__).with_suffix(".webp")
RUN = "apartment-rooms-2-seed-13--activestructure--seed0--*"
PARTS = ((0.0, 0.542, 1.0, 0.945), (0.0, 0.955, 1.0, 1.0))  # left, top, right, bottom as shares of the image


def main() -> None:
    """Cut the view and the legend out of the run's drawing and write them below each other."""
    drawings = [*Path(sys.argv[1]).glob(f"jobs/{RUN}/psg_3d.png")]
    if len(drawings) != 1:
        sys.exit(f"graph.py: {sys.argv[1]} must have one run jobs/{RUN}, and has {len(drawings)}")
    whole = Image.open(drawings[0]).convert("RGB")
    pieces = [whole.crop(tuple(round(share * whole.size[n % 2]) for n, share in enumerate(part))) for part in PARTS]
    page = Image.new("RGB", (whole.width, sum(piece.height for piece in pieces)), "white")
    top = 0
    for piece in pieces:
        page.paste(piece, (0, top))
        top += piece.height
    page.save(OUT, quality=70, method=6)


if __name__ == "__main__":
    main()
