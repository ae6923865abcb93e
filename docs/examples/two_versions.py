"""Two versions of OppLoD in one pass over a stimulus, in one table and one figure."""

import oppload_cli as oppload

versions = ["opplod", "opplod_reference"]
result = oppload.run("controls/looming-perspective", models=versions, rmo=False)
figure, axes = oppload.plot_curves(result, align="contact", xlim=(-1, 0.1))
figure.savefig("two-versions.png")
for version in versions:
    print(version, result.summary[version]["first_alarm_time_s"])
