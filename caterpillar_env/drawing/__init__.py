"""Pictures and videos of robots: backend, scenery, renderer, overlay, videos."""
