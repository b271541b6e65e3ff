float shadow_filter(SHADOW_MAPS, ShadowLookup at) {
    return shadow_nearest_tap(map, at, at.texel);
}
