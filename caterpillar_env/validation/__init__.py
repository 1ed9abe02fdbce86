"""Checks of the physics against closed forms, data sheets, symmetries and finer timesteps.

`caterpillar validate` and the tests run the same checks.
"""
