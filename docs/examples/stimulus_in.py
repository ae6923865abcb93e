"""A stimulus of the catalogue in, a table out: alarm and contact."""

import oppload_cli as oppload

protocol = oppload.stimulus.load("controls/looming-perspective")
result = oppload.run(protocol)
alarm = result.summary["opplod"]["first_alarm_time_s"]
contact = result.sidecar["stimulus"]["contact_time_s"]
print(result.frames[["time_s", "opplod_response", "opplod_alarm"]].tail())
print(f"the alarm starts {contact - alarm:.2f} s before contact")
