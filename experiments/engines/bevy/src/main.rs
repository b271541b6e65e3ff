//! `draw JOB OUTPUT LAYER FILE`: draws one output of a job with Bevy, without a window, and writes its half floats.
//!
//! `bevy_job.py` writes the job, a file of words; it says what they mean. Rows begin at the top.

use bevy::{
    app::ScheduleRunnerPlugin,
    asset::RenderAssetUsages,
    camera::{Hdr, RenderTarget},
    core_pipeline::tonemapping::{DebandDither, Tonemapping},
    light::{CascadeShadowConfigBuilder, DirectionalLightShadowMap, NotShadowCaster, ShadowFilteringMethod},
    mesh::{Indices, PrimitiveTopology},
    prelude::*,
    reflect::TypePath,
    render::{
        gpu_readback::{Readback, ReadbackComplete},
        render_resource::{AsBindGroup, Extent3d, TextureDimension, TextureFormat, TextureUsages},
    },
    shader::ShaderRef,
    window::ExitCondition,
};

/// The output that is the shadow map, see `probe.wgsl`.
const MAP: u32 = 7;
/// The first frames may lack what is still being compiled.
const FRAMES: u32 = 40;

#[derive(Asset, TypePath, AsBindGroup, Debug, Clone)]
struct Probe {
    #[uniform(0)]
    asked: UVec4,
}

impl Material for Probe {
    fn fragment_shader() -> ShaderRef {
        "probe.wgsl".into()
    }
}

/// The words of a job, one after another.
struct Words(std::vec::IntoIter<String>);

impl Words {
    fn word(&mut self) -> String {
        self.0.next().expect("the job ends early")
    }
    fn number(&mut self) -> f32 {
        let word = self.word();
        word.parse().unwrap_or_else(|_| panic!("{word} is no number"))
    }
    fn count(&mut self) -> usize {
        self.number() as usize
    }
    fn vector(&mut self) -> Vec3 {
        Vec3::new(self.number(), self.number(), self.number())
    }
}

#[derive(Resource)]
struct Job {
    text: String,
    output: u32,
    layer: u32,
    file: String,
}

fn mesh_of(positions: Vec<[f32; 3]>, normals: Vec<[f32; 3]>, faces: Vec<u32>) -> Mesh {
    let uv = vec![[0.0f32, 0.0]; positions.len()];
    Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::default())
        .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, positions)
        .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, normals)
        .with_inserted_attribute(Mesh::ATTRIBUTE_UV_0, uv)
        .with_inserted_indices(Indices::U32(faces))
}

fn main() {
    let given: Vec<String> = std::env::args().collect();
    let text = std::fs::read_to_string(&given[1]).expect("the job");
    let mut words = Words(text.split_whitespace().map(String::from).collect::<Vec<_>>().into_iter());
    let size = words.count();
    let assets = std::env::var("ASSETS").unwrap_or("assets".into());
    App::new()
        .insert_resource(ClearColor(Color::NONE))
        .insert_resource(DirectionalLightShadowMap { size })
        .insert_resource(Job { text: text.clone(), output: given[2].parse().unwrap(), layer: given[3].parse().unwrap(), file: given[4].clone() })
        .add_plugins(
            DefaultPlugins
                .set(WindowPlugin { primary_window: None, exit_condition: ExitCondition::DontExit, ..default() })
                .set(AssetPlugin { file_path: assets, ..default() }),
        )
        .add_plugins(MaterialPlugin::<Probe>::default())
        .add_plugins(ScheduleRunnerPlugin::run_loop(std::time::Duration::from_millis(20)))
        .add_systems(Startup, set_up)
        .run();
}

fn set_up(
    mut commands: Commands,
    job: Res<Job>,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<Probe>>,
    mut images: ResMut<Assets<Image>>,
) {
    let mut words = Words(job.text.split_whitespace().map(String::from).collect::<Vec<_>>().into_iter());
    let _size = words.count();
    let (width, height) = (words.count() as u32, words.count() as u32);
    let (eye, target) = (words.vector(), words.vector());
    let (fov, near, far) = (words.number(), words.number(), words.number());
    let filter = match words.word().as_str() {
        "Hardware2x2" => ShadowFilteringMethod::Hardware2x2,
        _ => ShadowFilteringMethod::Gaussian,
    };
    let kind = words.word();
    let is_spot = kind == "spot";
    let (shadow_depth_bias, shadow_normal_bias) = (words.number(), words.number());
    if is_spot {
        let (position, direction) = (words.vector(), words.vector());
        let (range, outer_angle, shadow_map_near_z) = (words.number(), words.number(), words.number());
        commands.spawn((
            SpotLight { shadow_maps_enabled: true, range, outer_angle, inner_angle: 0.0, shadow_depth_bias, shadow_normal_bias, shadow_map_near_z, ..default() },
            Transform::from_translation(position).looking_to(direction, Vec3::Y),
        ));
    } else {
        let direction = words.vector();
        let num_cascades = words.count();
        let config = CascadeShadowConfigBuilder {
            num_cascades,
            minimum_distance: words.number(),
            maximum_distance: words.number(),
            first_cascade_far_bound: words.number(),
            overlap_proportion: words.number(),
        };
        commands.spawn((
            DirectionalLight { shadow_maps_enabled: true, shadow_depth_bias, shadow_normal_bias, ..default() },
            config.build(),
            Transform::default().looking_to(direction, Vec3::Y),
        ));
    }
    let mut probe = |mesh: u32| materials.add(Probe { asked: UVec4::new(job.output, mesh, is_spot as u32, job.layer) });
    for index in 0..words.count() {
        let casts = words.count() == 1;
        let (vertices, faces) = (words.count(), words.count());
        let mut triples = |count: usize| (0..count).map(|_| words.vector().to_array()).collect::<Vec<_>>();
        let (positions, normals) = (triples(vertices), triples(vertices));
        let indices = (0..3 * faces).map(|_| words.count() as u32).collect();
        let mut entity = commands.spawn((
            Mesh3d(meshes.add(mesh_of(positions, normals, indices))),
            MeshMaterial3d(probe(index as u32 + 1)),
            Transform::default(),
        ));
        if !casts {
            entity.insert(NotShadowCaster);
        }
    }
    let camera = Transform::from_translation(eye).looking_at(target, Vec3::Y);
    if job.output == MAP {
        // A sheet before the camera, whose pixels are the map's texels.
        let corners = vec![[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [9.0, 9.0, 0.0], [-9.0, 9.0, 0.0]];
        let sheet = mesh_of(corners, vec![[0.0, 0.0, 1.0]; 4], vec![0, 1, 2, 0, 2, 3]);
        commands.spawn((
            Mesh3d(meshes.add(sheet)),
            MeshMaterial3d(probe(0)),
            camera * Transform::from_xyz(0.0, 0.0, -1.01 * near),
            NotShadowCaster,
        ));
    }
    let extent = Extent3d { width, height, depth_or_array_layers: 1 };
    let mut image = Image::new_fill(extent, TextureDimension::D2, &[0; 8], TextureFormat::Rgba16Float, RenderAssetUsages::default());
    image.texture_descriptor.usage |= TextureUsages::COPY_SRC | TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING;
    let image = images.add(image);
    commands.spawn((
        Camera3d::default(),
        Hdr,
        Msaa::Off,
        Tonemapping::None,
        DebandDither::Disabled,
        RenderTarget::Image(image.clone().into()),
        Projection::Perspective(PerspectiveProjection { fov: fov.to_radians(), near, far, ..default() }),
        filter,
        camera,
    ));
    let (file, mut seen) = (job.file.clone(), 0);
    commands.spawn(Readback::texture(image)).observe(move |event: On<ReadbackComplete>, mut exit: MessageWriter<AppExit>| {
        seen += 1;
        let is_drawn = event.data.iter().any(|&byte| byte != 0);
        if seen >= FRAMES && is_drawn {
            std::fs::write(&file, &event.data).expect("the output's file");
            exit.write(AppExit::Success);
        } else if seen > 10 * FRAMES {
            exit.write(AppExit::error());
        }
    });
}
