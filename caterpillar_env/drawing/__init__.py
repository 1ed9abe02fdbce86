"""How a robot looks: where it stands (`scenery`), pictures of it (`rendering`), what is written on them
(`overlay`), and what draws (`backend`). Nothing here moves anything.
"""
