"""Studies: several configurations (arms) with several seeds each, and the same simulated time for all.

`config` describes a study, `arms` has the kinds of runs, and `cells` runs them. `results` reads the
finished runs, and `statistics` has the formulas. `times`, `trends` and `analysis` compare the arms.
`winners` simulates the best robots again. `figures` draws the figures, and `report` writes the page.
"""
