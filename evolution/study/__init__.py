"""Studies: several configurations (arms) with several seeds each, at one budget of simulated time.

`config` describes a study, `arms` has the kinds of runs, and `cells` runs them. `results` reads the
finished runs, `statistics` has the formulas, and `analysis` compares the arms. `winners` simulates the
best robot of each arm again, and `report` writes figures and a page.
"""
