"""Physics checks that `caterpillar validate` and the tests run.

The references are closed forms, data sheets, symmetries, conservation laws and finer timesteps.
"""
