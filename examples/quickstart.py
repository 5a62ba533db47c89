# %% [markdown]
# # From logs to a proved model
#
# Two flights of a simulated Bebop 2 stand for your logs. With your own, begin at
# `rf.flight("my-log.csv", "my-drone.toml")`: the card says what each column means. Recordings of `rf.fly` carry theirs.

# %%
import numpy as np

import rotorfit as rf

for seed, path in enumerate(("train.mcap", "proof.mcap")):
    rf.fly(rf.plan("sim:bebop2", room=(6, 6, 4), duration=20, seed=seed), "sim:bebop2,gusts=0.2", path, seed=seed)

# %% [markdown]
# Read a log: what was recorded becomes commands and poses on one clock, in SI, with every repair noted.

# %%
train = rf.flight("train.mcap")
train.plot()
train

# %% [markdown]
# Fit: input, damping and delay of each axis, with 95 % intervals and findings.

# %%
fit = rf.fit(train)
fit.model.plot()
fit

# %% [markdown]
# Prove it on the other flight: the model's errors beside those of two baselines.

# %%
proof = rf.validate(fit, "proof.mcap")
proof.plot()
proof.to_frame()

# %% [markdown]
# Use it: a forward command of 0.2 for 3 s.

# %%
motion = rf.simulate(fit, [0.0], [[0.2, 0.0, 0.0, 0.0]], np.linspace(0.0, 3.0, 61))
motion.velocity[-1, 0]
