"""Images and videos of robots: OpenGL backend, scenery, renderer, overlay and video files."""
