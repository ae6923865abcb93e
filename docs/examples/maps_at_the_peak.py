"""The layers of OppLoD's reference, and the responses of its units, at the peak."""

import oppload_cli as oppload

best, layers, units = 0.0, {}, None
with oppload.open_source("controls/looming-perspective") as frames:
    rate = frames.facts.frame_rate
    model = oppload.OpplodReference(frames.working.shape, frame_rate=rate)
    for frame in frames:
        if (response := model.step(frame.luma)) and response.response > best:
            best, units = response.response, model.units.responses.copy()
            layers = {name: values.copy() for name, values in model.maps.items()}
print({name: round(float(values.mean()), 6) for name, values in layers.items()})
print(f"peak {best:.4f}, unit (row, column):", divmod(int(units.argmax()), units.shape[1]))
