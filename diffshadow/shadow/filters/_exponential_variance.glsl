vec4 shadow_moments(float depth) {
    float w = 2.0 * depth - 1.0;
    float upper = exp(SHADOW_POSITIVE_EXPONENT * w);
    float lower = exp(-SHADOW_NEGATIVE_EXPONENT * w);
    return vec4(upper, upper * upper, lower, lower * lower);
}

// Chebyshev's bound for the warp exp(c w) of depth, in units of the receiver's warped depth. Moments are clamped where
// they leave no bound.
float shadow_bound_of_warp(float c, vec2 moments, float receiver) {
    float mean = exp(min(log(moments.x) - c * receiver, SHADOW_MAX_LOG_MOMENT));
    float square = exp(min(log(moments.y) - 2.0 * c * receiver, SHADOW_MAX_LOG_MOMENT));
    // The warp's derivative by linear depth is 2 c exp(c w).
    float variance = max(square - mean * mean, 4.0 * c * c * SHADOW_LEAST_VARIANCE);
    return shadow_chebyshev(sign(c) * mean, variance, sign(c));
}

float shadow_bound(vec4 moments, float receiver) {
    float w = 2.0 * receiver - 1.0;
    float upper = shadow_bound_of_warp(SHADOW_POSITIVE_EXPONENT, moments.xy, w);
    return min(upper, shadow_bound_of_warp(-SHADOW_NEGATIVE_EXPONENT, moments.zw, w));
}
