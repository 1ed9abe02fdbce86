"""Interactive viewer: a robot crawls in the browser while sliders change its body, gait and friction.

`session` simulates the robot, `fields` lists the adjustable parameters, `scene` draws the robot, `panel`
contains controls and plots, `player` connects them for one browser tab, and `server` serves the page.
`scene`, `panel`, `player` and `server` require viser.
"""
