"""A robot in the browser: it crawls while its body, gait and friction are changed by hand.

`session` simulates the robot, `fields` lists the numbers that can be changed, `scene` draws the robot,
`panel` holds the controls and plots, `player` connects them for one browser tab, and `server` serves the
page. `scene`, `panel`, `player` and `server` need viser.
"""
