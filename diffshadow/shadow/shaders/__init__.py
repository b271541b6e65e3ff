"""Shaders: techniques in the languages of graphics APIs, for your own renderer."""

from ._technique import shader_buffers as shader_buffers
from ._technique import to_shader as to_shader
