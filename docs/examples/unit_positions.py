"""The positions of the units of three versions of OppLoD in a stimulus."""

import oppload_cli as oppload

for version in (oppload.Opplod, oppload.OpplodReference, oppload.OpplodPaper):
    with oppload.open_source("controls/looming-perspective", height=version.height) as frames:
        working = frames.working
    model = version(working.shape)
    x, y = model.units.centres_x * working.scale_x, model.units.centres_y * working.scale_y
    field = model.units.field * working.scale_x
    print(f"{model.name}: {len(x)} x {len(y)} units, fields of {field:.0f} source pixels")
    print(f"  across: {x[0]:.1f} to {x[-1]:.1f}; down: {y[0]:.1f} to {y[-1]:.1f}")
