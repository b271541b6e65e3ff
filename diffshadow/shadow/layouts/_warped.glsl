// Visibility of the light at a point of a surface: 1 lit, 0 shadowed.
//
// map: the shadow map's window depths without the warp, 1 where it is empty
// world_to_eye, eye_to_clip: the light's matrices without the warp
// warp: its strength, and the clip coordinate x of its centre
// position: of the surface in world units; normal: of its plane, of length 1, not interpolated
// to_light: unit vector from there to the light
// pixel: counted from the picture's lower left pixel, which is (0, 0); only patterns use it
// depth: distance of the surface along the camera's axis, in world units
float shadow(SHADOW_MAPS, mat4 world_to_eye, mat4 eye_to_clip, vec2 warp, vec3 position, vec3 normal, vec3 to_light, vec2 pixel, float depth) {
    ShadowView view = shadow_view(map, world_to_eye, eye_to_clip, 0);
    view.warp = warp;
    float lit = shadow_in_view(shadow_maps, view, position, normal, to_light, pixel);
    if (SHADOW_ENDS_SHADOWS && depth > SHADOW_END && dot(normal, to_light) > 0.0) {
        return 1.0;
    }
    return lit;
}
