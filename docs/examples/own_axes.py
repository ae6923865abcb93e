"""Curves in axes of one's own, beside another panel."""

import matplotlib.pyplot as plt

import oppload_cli as oppload

result = oppload.run("controls/looming-perspective")
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
oppload.plot_curves(result, axes=left, align="contact")
right.plot(result.frames["time_s"], result.frames["rmo_index"])
right.set(xlabel="time (s)", ylabel="RMO index")
figure.savefig("own-axes.png")
