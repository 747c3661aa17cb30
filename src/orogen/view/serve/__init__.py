"""The view in a browser: a small server that sends pictures and hears events, each page with a view of its own."""

from orogen.view.serve.drawing import Look
from orogen.view.serve.server import Server, ServerSettings

__all__ = ["Look", "Server", "ServerSettings"]
