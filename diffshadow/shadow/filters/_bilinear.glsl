float shadow_filter(SHADOW_MAPS, ShadowLookup at) {
    return shadow_bilinear_tap(map, at, at.texel);
}
