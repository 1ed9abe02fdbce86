"""Interactive viewer: a robot crawls in the browser while sliders change its body, gait and friction.

`session` simulates the robot, `fields` lists the adjustable parameters, `scene` draws the robot, `page`
connects them in one browser tab, and `server` serves the tabs. The last three require viser. The viewer
of MuJoCo 4, `mujoco.studio`, shows one simulation to all tabs and listens on all network interfaces.
"""
