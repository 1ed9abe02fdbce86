"""Studies: several configurations (arms) with several seeds each, at one budget of simulated time.

`config` describes a study, `arms` the kinds of runs, and `cells` runs them. `results` reads the finished
runs, `statistics` has the formulas, `analysis` compares the arms, `winners` simulates their best robots
again, and `report` writes figures and a page.
"""
