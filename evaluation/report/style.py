"""Define the colours, dash patterns and markers of all tables, charts and images."""

from __future__ import annotations

# Colours of policies by index: those of Okabe and Ito, which people with colour blindness can distinguish.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F", "#000000")
# The same hues for a dark background.
COLOURS_BY_NIGHT = ("#4DA3E0", "#F0803C", "#2FC79A", "#E29BC5", "#F2BC45", "#8CCDF5", "#A9B1B8", "#F1F3F5")
# Dash patterns and markers of matplotlib by policy index, for prints in black and white.
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)), (0, (3, 3)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")

INK, FAINT_INK, PAPER = (33, 37, 41), (108, 117, 125), (255, 255, 255)  # text, faint text, background (RGB)
HAIR = (206, 212, 218)  # frames around images
# Colours of plans where no surface is mapped. None of them is white, so a gap differs from a white floor.
UNKNOWN, FREE, OCCUPIED = (181, 187, 193), (200, 227, 246), (73, 80, 87)
START, END = (0, 158, 115), (213, 94, 0)


def colour(index: int) -> str:
    """Return the colour of the policy with this index as a hex code; colours repeat after the last one."""
    return COLOURS[index % len(COLOURS)]


def is_grey(index: int) -> bool:
    """Return whether the policy with this index is drawn in grey, since all colours are taken."""
    return index >= len(COLOURS)


def hue(index: int) -> str:
    """Return the CSS class by which the page colours elements of the policy with this index."""
    return "rest" if is_grey(index) else f"p{index}"


def path_colour(share: float) -> tuple[int, int, int]:
    """Return the RGB colour of a path at ``share`` of its frames: dark blue at 0 (first), yellow at 1 (last)."""
    stops = ((44, 27, 110), (48, 103, 141), (33, 144, 140), (94, 186, 95), (238, 203, 36))
    position = min(max(share, 0.0), 1.0) * (len(stops) - 1)
    low = min(int(position), len(stops) - 2)
    part = position - low
    red, green, blue = (round((1 - part) * a + part * b) for a, b in zip(stops[low], stops[low + 1]))
    return red, green, blue


STRUCTURAL, OBJECT = (0, 114, 178), (230, 159, 0)  # structural planes (blue) and object planes (orange)
TREE = (33, 37, 41)  # edges of the graph in its spanning forest
EDGE = (134, 142, 150)  # other edges of the graph
# Borders between the colour classes of a plane's deficit. Classes are half a decade, and darker for larger deficits.
DEFICIT_BOUNDS = (0.001, 0.003, 0.01, 0.03, 0.1)
DEFICIT_LABELS = (
    f"deficit < {DEFICIT_BOUNDS[0]:g}",
    *(f"{low:g} to {high:g}" for low, high in zip(DEFICIT_BOUNDS, DEFICIT_BOUNDS[1:])),
    f"{DEFICIT_BOUNDS[-1]:g} or more",
)
DEFICIT_COLOURS = ((251, 233, 198), (250, 196, 124), (240, 148, 82), (213, 89, 61), (160, 38, 78), (80, 16, 84))


def deficit_colour(deficit: float) -> tuple[int, int, int]:
    """Return the RGB colour of the class to which a plane's deficit belongs."""
    return DEFICIT_COLOURS[sum(deficit >= bound for bound in DEFICIT_BOUNDS)]


def plane_colour(structural: bool) -> tuple[int, int, int]:
    """Return the RGB colour of a plane: blue if it is structural, orange if it is an object plane."""
    return STRUCTURAL if structural else OBJECT
