"""One input under two presets, in one figure."""

import oppload_cli as oppload

results = [
    oppload.run("controls/looming-perspective", preset, models=["opplod"], rmo=False)
    for preset in ("default", "reference")
]
figure, axes = oppload.plot_curves(results, align="contact", xlim=(-1, 0.1))
figure.savefig("two-presets.png")
for result in results:
    print(result.sidecar["preset"], result.summary["opplod"]["first_alarm_time_s"])
