float shadow_filter(SHADOW_MAPS, ShadowLookup at) {
    float r = SHADOW_RADIUS;
    float below = shadow_bilinear_tap(map, at, at.texel + vec2(-r, -r)) + shadow_bilinear_tap(map, at, at.texel + vec2(r, -r));
    float above = shadow_bilinear_tap(map, at, at.texel + vec2(-r, r)) + shadow_bilinear_tap(map, at, at.texel + vec2(r, r));
    return 0.25 * (below + above);
}
