// Where the map is tapped, and what is compared there.
struct ShadowLookup {
    int layer;  // of the map
    vec2 texel;  // in texels from the lower left corner
    float depth;  // window depth less the bias
    float depth_per_texel;  // window depth over a texel's width
    vec2 slope;  // of the compared depth along the map's x and y, in window depth per texel
    float deepest;  // bound on the compared depth
    vec2 extent;  // width and height of a texel in world units; of a spot light, at a distance of 1
    vec2 pixel;  // counted from the picture's lower left pixel, which is (0, 0)
};

// A compare with a texel: 1 lit, 0 shadowed. Nothing casts a shadow where the map is empty.
float shadow_compared(sampler2D map, ShadowLookup at, ivec2 texel) {
    float stored = shadow_stored(map, at.layer, texel);
    if (stored == 1.0) {
        return 1.0;
    }
    vec2 to = vec2(texel) + vec2(0.5, 0.5) - at.texel;
    float depth = min(at.depth + at.slope.x * to.x + at.slope.y * to.y, at.deepest);
    return shadow_compare(stored, depth, at.depth_per_texel);
}
