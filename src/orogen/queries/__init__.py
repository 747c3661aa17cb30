"""Heights, normals, rays, lines of sight and what is made of them, on the CPU."""

from orogen.queries.field import Field
from orogen.queries.queries import Profile, Queries
from orogen.queries.sight import Sight

__all__ = ["Field", "Profile", "Queries", "Sight"]
