"""ActiveStructure Gym: Gymnasium environments and planners for active 3D reconstruction with Gaussian maps.

Importing the package registers the environments ``ActiveStructure/Room-v0``, ``Apartment-v0``, ``Mesh-v0``,
``Replica-v0`` and ``Matterport3D-v0``; ``gymnasium.make("activestructure_gym:ActiveStructure/Room-v0")`` does both,
in every worker process too.
"""

from pathlib import Path

from activestructure_gym._version import __version__

# A wheel holds envs/, policies/ and evaluation/ inside this package; a checkout
# holds them beside it (package_dir in setup.cfg).  Both import by the same name.
_package = Path(__file__).resolve().parent
if not (_package / "envs").is_dir():
    __path__.append(str(_package.parent))

__all__ = ["__version__"]

from activestructure_gym.envs.registration import register_envs  # noqa: E402  (needs the bridge above)

register_envs()
