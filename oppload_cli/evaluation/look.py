"""How the page of an evaluation looks, on a wide screen and on a phone."""

from __future__ import annotations

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; margin: 0 auto;
  max-width: 76rem; padding: 1.5rem; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: .5rem 0; }
h2 { font-size: 1.3rem; margin: 0 0 .5rem; } h3 { font-size: 1.05rem; margin: 1.5rem 0 .5rem; }
section { border-top: 1px solid #ccc; padding-top: 1.25rem; margin-top: 2.25rem; }
.note { color: #555; font-size: .9rem; max-width: 60rem; }
p { max-width: 60rem; }
code { background: #f3f3f3; padding: .1rem .3rem; border-radius: 3px; font-size: .85em;
  overflow-wrap: anywhere; }
.faults { background: #fdf1d8; border: 1px solid #d9b765; border-radius: 4px;
  padding: .6rem 1rem; } .faults ul { margin: .25rem 0; padding-left: 1.25rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .9rem; min-width: 100%; }
th, td { text-align: left; vertical-align: top; padding: .35rem .7rem .35rem 0;
  border-bottom: 1px solid #e2e2e2; }
thead th { vertical-align: bottom; font-weight: 600; color: #444; border-bottom: 2px solid #999; }
tbody th { font-weight: 500; } td { font-variant-numeric: tabular-nums; white-space: nowrap; }
th[scope=row] { position: sticky; left: 0; background: #fff; min-width: 7rem; }
.all th[scope=row] { min-width: 13rem; }
.measure th { padding-top: 1.1rem; font-weight: 600; border-bottom: 1px solid #999; }
.value { font-weight: 600; } .spread { color: #777; font-size: .82rem; display: block; }
.yes { color: #00533c; background: #e3f4ee; padding: 0 .35rem; border-radius: 3px; }
.no { color: #8a2b00; background: #fbe6dc; padding: 0 .35rem; border-radius: 3px; }
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(30rem, 100%), 1fr));
  gap: 1.5rem; align-items: start; }
.stills { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(16rem, 100%), 1fr));
  gap: 1.25rem; }
figure { margin: 0; } img { width: 100%; height: auto; display: block; }
.plot img { max-width: 40rem; margin: 0 auto; }
figcaption { color: #555; font-size: .85rem; margin-top: .3rem; overflow-wrap: anywhere; }
.frame { position: relative; overflow: hidden; background: #eee; min-height: 3rem; }
.boxes { position: absolute; inset: 0; width: 100%; height: 100%; fill: none; }
.boxes * { vector-effect: non-scaling-stroke; stroke-width: 2; }
.winner { stroke: #ff7a1a; } .label { stroke: #fff; stroke-dasharray: 5 3; }
.strip { display: block; width: 100%; height: auto; background: #f7f7f7; margin-top: 2px; }
.strip * { fill: none; vector-effect: non-scaling-stroke; }
.strip .approach { fill: #d9e6f2; } .response { stroke: #d55e00; stroke-width: 1.4; }
.threshold { stroke: #222; stroke-dasharray: 4 3; } .now { stroke: #0072b2; stroke-width: 1.2; }
dt { font-weight: 600; margin-top: .8rem; } dd { margin: .1rem 0 0; max-width: 60rem; }
details { margin: .4rem 0; } summary { cursor: pointer; }
@media (max-width: 40rem) { body { padding: 1rem; } h1 { font-size: 1.4rem; } }
"""
