"""policy-train: PPO through the runtime that ships."""
