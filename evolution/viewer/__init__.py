"""A robot in the browser: it crawls while its body, gait and friction are changed by hand.

`session` is the robot of one page, `fields` what can be changed of it, `scene` draws it, `panel` holds
controls and plots, `player` lets time pass, `server` serves the page, `command` is `caterpillar view`.
`scene`, `panel`, `player` and `server` need viser.
"""
