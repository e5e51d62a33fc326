"""Define colours, dash patterns and markers of all tables, curves and images."""

from __future__ import annotations

# Okabe and Ito's colours, distinguishable with colour blindness; consecutive ones differ strongly.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F", "#000000")
# The same hues on a dark background.
COLOURS_BY_NIGHT = ("#4DA3E0", "#F0803C", "#2FC79A", "#E29BC5", "#F2BC45", "#8CCDF5", "#A9B1B8", "#F1F3F5")
# Dash patterns and markers differ as well, for prints in black and white.
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)), (0, (3, 3)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")

INK, FAINT_INK, PAPER = (33, 37, 41), (108, 117, 125), (255, 255, 255)
HAIR = (206, 212, 218)  # frames around images
# Colours of plans. None of them is white, so a gap in the map differs from a white floor.
UNKNOWN, FREE, OCCUPIED = (181, 187, 193), (200, 227, 246), (73, 80, 87)
START, END = (0, 158, 115), (213, 94, 0)


def colour(index: int) -> str:
    """Return the colour of the policy with this index."""
    return COLOURS[index % len(COLOURS)]


def is_grey(index: int) -> bool:
    """Return whether the policy with this index has no colour of its own and is drawn in grey."""
    return index >= len(COLOURS)


def hue(index: int) -> str:
    """Return the CSS class of the elements that the page draws in a policy's colour."""
    return "rest" if is_grey(index) else f"p{index}"


def path_colour(share: float) -> tuple[int, int, int]:
    """Return the colour of a share of the path: from dark blue at the first frame (0) to yellow at the last (1)."""
    stops = ((44, 27, 110), (48, 103, 141), (33, 144, 140), (94, 186, 95), (238, 203, 36))
    position = min(max(share, 0.0), 1.0) * (len(stops) - 1)
    low = min(int(position), len(stops) - 2)
    part = position - low
    red, green, blue = (round((1 - part) * a + part * b) for a, b in zip(stops[low], stops[low + 1]))
    return red, green, blue


# Planes by type, and the curves of structural and object planes.
STRUCTURAL, OBJECT = (0, 114, 178), (230, 159, 0)
TREE = (33, 37, 41)  # edges of the spanning forest
EDGE = (134, 142, 150)  # the other edges
# Deficits span three orders of magnitude; the classes are half decades, darker for larger deficits.
DEFICIT_BOUNDS = (0.001, 0.003, 0.01, 0.03, 0.1)
DEFICIT_LABELS = (
    f"deficit < {DEFICIT_BOUNDS[0]:g}",
    *(f"{low:g} to {high:g}" for low, high in zip(DEFICIT_BOUNDS, DEFICIT_BOUNDS[1:])),
    f"{DEFICIT_BOUNDS[-1]:g} or more",
)
DEFICIT_COLOURS = ((251, 233, 198), (250, 196, 124), (240, 148, 82), (213, 89, 61), (160, 38, 78), (80, 16, 84))


def deficit_colour(deficit: float) -> tuple[int, int, int]:
    """Return the colour of a deficit's class."""
    return DEFICIT_COLOURS[sum(deficit >= bound for bound in DEFICIT_BOUNDS)]


def plane_colour(structural: bool) -> tuple[int, int, int]:
    """Return blue for structural planes and orange for object planes."""
    return STRUCTURAL if structural else OBJECT
