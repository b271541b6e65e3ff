// The least bias that moves the receiver to the depth of its own plane at the centre of its texel (Dou et al. 2014).
float shadow_adaptive_bias(ShadowReceiver at) {
    vec2 apart = at.texel - (floor(at.texel) + vec2(0.5, 0.5));
    return (max(dot(at.slope, apart), 0.0) + SHADOW_EPSILON) * at.depth_per_texel + at.rounding;
}
