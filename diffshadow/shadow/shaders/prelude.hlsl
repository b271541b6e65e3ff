#define shadow_select(no, yes, condition) ((condition) ? (yes) : (no))

int2 shadow_size(Texture2D<float> map) {
    uint width, height;
    map.GetDimensions(width, height);
    return int2(width, height);
}

// Rows are counted from the bottom, as window coordinates are in the functions below; Direct3D stores the top row first.
float shadow_fetch(Texture2D<float> map, int2 texel) {
    return map.Load(int3(texel.x, shadow_size(map).y - 1 - texel.y, 0));
}

float4 shadow_times(float4x4 matrix_, float4 vector_) { return mul(matrix_, vector_); }

// Direct3D's clip space has depths from 0 to 1.
float3 shadow_window(float4 clip) { return float3(clip.xy / clip.w * 0.5 + 0.5, clip.z / clip.w); }

int2 shadow_texture_size(ShadowTexture image) {
    uint width, height;
    image.GetDimensions(width, height);
    return int2(width, height);
}

float4 shadow_texel(ShadowTexture image, int2 texel) {
    return image.Load(int3(texel.x, shadow_texture_size(image).y - 1 - texel.y, 0));
}
