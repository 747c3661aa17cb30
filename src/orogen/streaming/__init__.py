"""Which nodes of the terrain are on the GPU, and how shaders find them: the chunked clipmap."""
