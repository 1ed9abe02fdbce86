"""Studies: several configurations (arms) with several seeds each, and the same simulated time for all.

`config` describes a study, `arms` has the kinds of runs, and `cells` runs them. `results` reads the
finished runs, `statistics` has the formulas, and `analysis` compares the arms. `winners` simulates the
best robot of each arm again, and `report` writes figures and a page.
"""
