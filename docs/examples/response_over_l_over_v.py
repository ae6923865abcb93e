"""The peak response, and its lead before contact, over l/v."""

import oppload_cli as oppload

print("l/v (ms)  peak  lead (s)")
for protocol in oppload.stimulus.load_all("klapoetke2017/loom-l-over-v"):
    result = oppload.run(protocol, models=["opplod_reference"], rmo=False)
    contact = result.sidecar["stimulus"]["contact_time_s"]
    peak = result.summary["opplod_reference"]
    l_over_v = protocol.objects[0].growth.l_over_v_ms
    print(f"{l_over_v:8.0f}  {peak['peak']:.4f}  {contact - peak['peak_time_s']:.3f}")
