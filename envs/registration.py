"""Define the environment IDs and register them.

Entry points are strings. Registering therefore imports no environment, and a registered spec can be written as JSON.
"""

from __future__ import annotations

import gymnasium

NAMESPACE = "ActiveStructure"
TASKS = {
    "Room-v0": "RoomEnv",
    "Apartment-v0": "ApartmentEnv",
    "Mesh-v0": "MeshEnv",
    "Replica-v0": "ReplicaEnv",
    "Matterport3D-v0": "Matterport3DEnv",
    "World-v0": "WorldEnv",
}
ENV_IDS = tuple(f"{NAMESPACE}/{task}" for task in TASKS)


def register_envs() -> None:
    """Register the ``ActiveStructure/...`` IDs with Gymnasium; further calls have no effect."""
    for task, class_name in TASKS.items():
        env_id = f"{NAMESPACE}/{task}"
        if env_id not in gymnasium.registry:
            gymnasium.register(env_id, entry_point=f"activestructure_gym.envs.tasks:{class_name}")
