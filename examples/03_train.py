"""Train PPO of Stable-Baselines3 on an environment of this project, and play an episode with the trained policy."""

import gymnasium as gym
from stable_baselines3 import PPO

from activestructure_gym.policies.learned import CandidatePolicy, with_used_keys

env = with_used_keys(gym.make("activestructure_gym:ActiveStructure/Room-v0", preset="fast"))
model = PPO(CandidatePolicy, env, n_steps=64, batch_size=64, gamma=0.3, learning_rate=1e-3, verbose=1)
model.learn(4096)
observation, info = env.reset(seed=0)
ended = False
while not ended:
    action, _ = model.predict(observation, deterministic=True)
    observation, reward, terminated, truncated, info = env.step(action)
    ended = terminated or truncated
print(f"{info['frames']} frames, {info['metres']:.1f} m")
