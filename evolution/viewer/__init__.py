"""A robot in the browser: it crawls while its body, gait and friction are changed by hand.

`session` is the robot of one page, `scene` draws it, `panel` holds its controls and plots, `player` lets
time pass, and `command` serves the page. Only `command` may be imported where viser is not installed.
"""
