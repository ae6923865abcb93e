"""The positions of OppLoD's units in a stimulus, under each preset."""

import oppload_cli as oppload

for preset in ("default", "reference", "paper"):
    with oppload.open_source("controls/looming-perspective", preset=preset) as frames:
        working = frames.working
    model = oppload.Opplod(working.shape, oppload.parameters_of("opplod", preset))
    x, y = model.units.centres_x * working.scale_x, model.units.centres_y * working.scale_y
    field = model.units.field * working.scale_x
    print(f"{preset}: {len(x)} x {len(y)} units, fields of {field:.0f} source pixels")
    print(f"  across: {x[0]:.1f} to {x[-1]:.1f}; down: {y[0]:.1f} to {y[-1]:.1f}")
