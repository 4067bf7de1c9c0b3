"""Judge a lift: what it does to the crane, up to which wind it can be made, and whether it may go.

Begin with `judgement.judge`: it plans the lift of a site, certifies it, simulates it with
perturbations and in gusts, and checks all that is required.

    from cranedyn.lifts.judging.chart import CHARTS, read_chart
    from cranedyn.lifts.judging.judgement import judge
    from cranedyn.lifts.planning.site_file import SITES, read_site

    site = read_site(SITES / "open_yard.toml")
    judgement = judge(site, read_chart(CHARTS / "laboratory.toml"))
    print(judgement.word, judgement.reasons)
    judgement.report("lift.html")

Public names:

* `judgement.judge` returns a `Judgement`: `word` (GO, NO GO or NOT COMPLETE), `reasons`, `checks`,
  `analysis` with every number, `tables()`, `figures`, `report(path)`. It needs the extra
  `planning`.
* `judged_inputs.resolve_inputs`: the values that a lift is judged with, each with where it is from.
* `analysis.Requirements`: wind, swing, risk, number of perturbed lifts and gusts.
* `loads.loads`: rope, load moment, slewing ring, foot and corners of any recorded run. It needs the
  core only, as do charts and formulas.
* `chart.read_chart`, `chart.assess_run`: utilisation of a load chart, and where a limiter acts.
* `factors`, `wind_standards`: dynamic factors and wind of the standards, as functions.

To add a check or a load case, write a function that takes the `analysis.LiftAnalysis` and returns a
`cranedyn.verdict.Check`, and enter it in `lift_checks.CHECKS`, or pass it to `judge`. A table is a
function in `lift_tables.tables`, a figure one in `lift_figures.figures`.

In the order to read: `judgement` (10 minutes) runs everything, with the values of `judged_inputs`,
and keeps the results in `analysis`; `lift_checks` asks them. Of what they are made: `loads`, then
`wrench`, which says how loads follow from the motion; `chart` and `plausible_chart`; `wind_limit`;
`factors` and `wind_standards`. The report: `lift_tables`, `lift_figures`, `report_page`.

A report becomes a plan that somebody signs by its record: `plan_record` is the format, and its only
reader and writer; `plan_inputs` reads the files of a plan, `plan_writing` writes page, PDF and
record, `plan_folder` knows revisions and signatures, `plan_changes` compares results, and
`verify_plan` puts these together. `comparison` and `comparison_page` set many lifts beside each
other.

The judging stands above `cranedyn.lifts.planning`; docs/concepts/lifting.md derives the formulas.
"""
