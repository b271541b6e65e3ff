vec4 shadow_moments(float depth) {
    return vec4(exp(SHADOW_EXPONENT * (depth - 1.0)), 0.0, 0.0, 0.0);
}

float shadow_bound(vec4 moments, float receiver) {
    return exp(min(log(moments.x) + SHADOW_EXPONENT * (1.0 - receiver), 0.0));
}
