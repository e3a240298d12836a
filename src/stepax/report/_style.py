"""How a page looks: on a wide screen, on a phone, and on paper."""

STYLE = """
:root { --ink: #16202b; --quiet: #5b6672; --line: #dde2e7; --deep: #0b2a4a; --warn: #8a4b00; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 62rem; padding: 1.5rem 1.25rem 3rem; color: var(--ink);
  background: #fff; font: 16px/1.5 system-ui, "Segoe UI", Roboto, Helvetica, Arial, sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0 0 .2rem; overflow-wrap: anywhere; }
h2 { font-size: 1.12rem; margin: 2.2rem 0 .6rem; padding-top: .5rem;
  border-top: 1px solid var(--line); color: var(--deep); }
p { margin: .25rem 0; overflow-wrap: anywhere; }
.about { color: var(--quiet); }
.formula { overflow-x: auto; padding: .4rem 0; }
math { font-size: 1.18rem; font-family: "Latin Modern Math", "STIX Two Math", "Cambria Math",
  math, serif; }
.formula math { display: inline math; math-style: normal; }
.facts { display: grid; grid-template-columns: max-content 1fr; gap: .15rem 1.1rem;
  margin: .4rem 0; }
.facts dt { color: var(--quiet); }
.facts dd { margin: 0; overflow-wrap: anywhere; }
.facts.large { display: flex; flex-wrap: wrap; gap: .4rem 2.4rem; }
.facts.large dd { font-size: 1.35rem; font-variant-numeric: tabular-nums; }
.facts.large div { min-width: 5rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .92rem; }
th { text-align: left; font-weight: 600; color: var(--quiet); border-bottom: 1.5px solid #9aa5b1;
  white-space: nowrap; }
th, td { padding: .3rem .9rem .3rem 0; vertical-align: middle; }
td { border-bottom: 1px solid var(--line); }
tr { break-inside: avoid; }
.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td math { font-size: 1rem; display: inline math; math-style: normal; }
td math .name { display: none; }
td.long { min-width: 15rem; }
figure { margin: .8rem 0 1.2rem; break-inside: avoid; }
figure svg { display: block; width: 100%; height: auto; }
figcaption { color: var(--quiet); font-size: .88rem; }
.narrow { display: none; }
.plots { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 25rem), 1fr));
  gap: 0 2rem; }
.live { display: none; }
.notes { padding: 0; margin: .4rem 0; list-style: none; }
.notes li { border-left: 3px solid #e0a341; padding: .1rem 0 .1rem .8rem; margin: .55rem 0; }
.notes b { display: block; color: var(--warn); font-weight: 600; }
.code { margin: .5rem 0; }
.code span { color: var(--quiet); font-size: .85rem; }
pre { margin: .1rem 0 0; padding: .55rem .7rem; background: #f4f6f8; border-radius: 4px;
  font: .84rem/1.45 ui-monospace, Consolas, "DejaVu Sans Mono", monospace; white-space: pre-wrap;
  overflow-wrap: anywhere; }
.drawn .live { display: block; }
.drawn .still { display: none; }
@media screen and (max-width: 40rem) {
  body { padding: 1rem .8rem 2rem; font-size: 15px; }
  math { font-size: 1rem; }
  table { font-size: .8rem; }
  th, td { padding-right: .5rem; }
  .wide { display: none; }
  .narrow { display: block; }
  .facts:not(.large) { grid-template-columns: 1fr; gap: 0; }
  .facts:not(.large) dd { margin-bottom: .35rem; }
}
@media print {
  @page { size: A4; margin: 14mm 14mm 16mm; }
  body { max-width: none; padding: 0; font-size: 10pt; }
  h1 { font-size: 16pt; }
  h2 { font-size: 11.5pt; margin-top: 14pt; break-after: avoid; }
  table { font-size: 8pt; }
  td math { font-size: 8.5pt; }
  th, td { padding: 1.5pt 5pt 1.5pt 0; }
  td.long { min-width: 0; }
  pre { font-size: 8pt; background: none; border: .5pt solid var(--line); }
  .scroll { overflow: visible; }
  .wide { display: block; }
  .still, .drawn .still { display: block; }
  .narrow, .live, .drawn .live { display: none; }
  .notes li, .code { break-inside: avoid; }
}
"""
