// Writes what Bevy's own shadow functions give, or what they are given, in place of a colour.
#import bevy_pbr::{forward_io::VertexOutput, mesh_view_bindings, shadows}

struct Asked { output: u32, mesh: u32, is_spot: u32, layer: u32 }
@group(#{MATERIAL_BIND_GROUP}) @binding(0) var<uniform> asked: Asked;

const VISIBILITY: u32 = 0u;
const POSITION: u32 = 1u;
const NORMAL: u32 = 4u;
const MAP: u32 = 7u;

// A half float keeps whole numbers up to 2048, so four of them keep a float's bytes.
fn as_bytes(value: f32) -> vec4<f32> {
    let bits = bitcast<u32>(value);
    return vec4<f32>(vec4<u32>(bits, bits >> 8u, bits >> 16u, bits >> 24u) & vec4<u32>(255u));
}

@fragment
fn fragment(seen: VertexOutput) -> @location(0) vec4<f32> {
    let normal = normalize(seen.world_normal);
    if (asked.output == VISIBILITY) {
        var lit: f32;
        if (asked.is_spot == 1u) {
            let near = mesh_view_bindings::clustered_lights.data[0].shadow_map_near_z;
            lit = shadows::fetch_spot_shadow(0u, seen.world_position, normal, near, seen.position.xy);
        } else {
            let m = mesh_view_bindings::view.view_from_world;
            let row = vec4<f32>(m[0].z, m[1].z, m[2].z, m[3].z);
            lit = shadows::fetch_directional_shadow(0u, seen.world_position, normal, dot(row, seen.world_position), seen.position.xy);
        }
        // One more than the mesh, so that nothing is 0.
        return vec4<f32>(lit, f32(asked.mesh), 0.0, 1.0);
    }
    if (asked.output < NORMAL) { return as_bytes(seen.world_position[asked.output - POSITION]); }
    if (asked.output < MAP) { return as_bytes(normal[asked.output - NORMAL]); }
    return as_bytes(textureLoad(mesh_view_bindings::directional_shadow_textures, vec2<i32>(seen.position.xy), i32(asked.layer), 0));
}
