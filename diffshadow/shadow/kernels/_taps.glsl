// A compare with the texel that a point falls in.
float shadow_nearest_tap(sampler2D map, ShadowLookup at, vec2 place) {
    return shadow_compared(map, at, ivec2(floor(place)));
}

// The compares with the four texels around a point, interpolated.
float shadow_bilinear_tap(sampler2D map, ShadowLookup at, vec2 place) {
    vec2 corner = floor(place - vec2(0.5, 0.5));
    vec2 t = place - vec2(0.5, 0.5) - corner;
    ivec2 first = ivec2(corner);
    float below = mix(shadow_compared(map, at, first), shadow_compared(map, at, first + ivec2(1, 0)), t.x);
    float above = mix(shadow_compared(map, at, first + ivec2(0, 1)), shadow_compared(map, at, first + ivec2(1, 1)), t.x);
    return mix(below, above, t.y);
}
