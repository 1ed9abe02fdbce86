"""Studies: arms times seeds at one budget, and what they amount to.

`config` says what is asked, `arms` who runs it, `cells` where; `results` collects what came out,
`statistics` has the formulas, `analysis` the tables, `headline` the sentences; `winners` looks at the
best robots again, `report` writes figures and page.
"""
