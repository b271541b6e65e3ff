float shadow_filter(sampler2D map, ShadowLookup at) {
    return shadow_bilinear_tap(map, at, at.texel);
}
