use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use naga::{AddressSpace, Binding, ResourceBinding, ShaderStage};

use super::*;
use crate::composite::{COMPOSITE, CompositeUniform};
use crate::denoise::{GUIDES, HOLOVOL, PAPER, pass_defs};
use crate::depth::{DEPTH, SourceUniform};
use crate::fetch::FETCH;
use crate::frame::RESUME;
use crate::light_grid::{SETTLE, SettleUniform};
use crate::majorant::MAJORANT;
use crate::trace::TRACE;
use crate::trace::contract::CONTRACT;
use crate::view_depth::{VIEW_DEPTH, ViewDepthUniform};

/// Definitions of a plain scene; the tests vary them.
const PLAIN: &[(&str, u32)] = &[
    ("CELL_SIZE", 8),
    ("TRANSFER_POINTS", 6),
    ("UNROLLED_POINTS", 16),
    ("HARDWARE_INTERPOLATION", 0),
    ("SURFACE", 0),
    ("EMISSION", 0),
    ("MULTIPLE_SCATTERING", 0),
    ("CONSTANT_ENVIRONMENT", 0),
    ("ENVIRONMENT_CANDIDATES", 1),
    ("SCATTER_CANDIDATES", 1),
    ("LIGHT_BANDS", holovol_light::LIGHT_BANDS as u32),
    ("SLICES", 1),
    ("MESH_DEPTH", 0),
    ("SAMPLE_SHARES", 0),
    ("LIGHT_GRID", 0),
    ("SHARE_BLOCK", 8),
    ("CLIP_PLANES", 0),
    ("CLIP_PLANES_MAX", 8),
    ("VIEWS_MAX", 8),
    ("GUIDES", 0),
    ("STATISTICS", 0),
    ("WHITE_NOISE", 0),
    ("SUBGROUPS", 0),
    ("STEPS_PER_ROUND", 4),
    ("SERVE_RATIO", 2),
    ("FOLD_SAMPLES", 1024),
    ("SAVED_PATH_VECTORS", 16),
    ("PICKS", 4),
    ("WORKGROUP_SIZE", 64),
];

fn with(changes: &[(&'static str, u32)]) -> ShaderDefs {
    let mut defs = PLAIN.to_vec();
    for &(name, value) in changes {
        let def = defs.iter_mut().find(|def| def.0 == name);
        def.expect("a known definition").1 = value;
    }
    defs
}

/// What changes the structure of the code, all ways; numbers and counters one by one.
fn variants() -> Vec<ShaderDefs> {
    let structure = [
        "SURFACE",
        "EMISSION",
        "MULTIPLE_SCATTERING",
        "CONSTANT_ENVIRONMENT",
        "SUBGROUPS",
        "GUIDES",
    ];
    let mut variants = Vec::new();
    for bits in 0..1u32 << structure.len() {
        let bit = |i: usize| bits >> i & 1;
        let mut changes: Vec<_> = (0..structure.len())
            .map(|i| (structure[i], bit(i)))
            .collect();
        if bit(3) == 1 {
            changes.extend([("ENVIRONMENT_CANDIDATES", 0), ("SCATTER_CANDIDATES", 1)]);
        }
        variants.push(with(&changes));
    }
    let surface = ("SURFACE", 1);
    variants.extend(
        [
            vec![("SLICES", 0)],
            vec![("SLICES", 0), ("HARDWARE_INTERPOLATION", 1), surface],
            vec![("STATISTICS", 1)],
            vec![("LIGHT_GRID", 1)],
            vec![("LIGHT_GRID", 1), ("MULTIPLE_SCATTERING", 1), surface],
            vec![("MESH_DEPTH", 1)],
            vec![("CLIP_PLANES", 1)],
            vec![("CLIP_PLANES", 8), ("MESH_DEPTH", 1), surface],
            vec![("WHITE_NOISE", 1)],
            vec![("TRANSFER_POINTS", 0), surface],
            vec![("TRANSFER_POINTS", 1)],
            vec![("TRANSFER_POINTS", 16), surface],
            vec![
                ("PICKS", 1),
                ("SAVED_PATH_VECTORS", 13),
                ("MULTIPLE_SCATTERING", 1),
            ],
            vec![("ENVIRONMENT_CANDIDATES", 1), ("SCATTER_CANDIDATES", 0)],
            vec![
                ("ENVIRONMENT_CANDIDATES", 4),
                ("SCATTER_CANDIDATES", 2),
                surface,
            ],
            vec![("CELL_SIZE", 16384)],
        ]
        .iter()
        .map(|changes| with(changes)),
    );
    variants
}

fn resume_defs() -> ShaderDefs {
    vec![
        ("COUNTERS", 8),
        ("SAVED_PATHS", 0),
        ("RESUMED_PATHS", 6),
        ("UNLIMITED", 7),
        ("QUEUE_CAPACITY", 65536),
        ("WORKGROUP_SIZE", 64),
    ]
}

#[test]
fn small_structs_lie_in_memory_as_their_kernels_read_them() {
    assert_same_layout!(
        &COMPOSITE,
        &Vec::new(),
        "Composite",
        CompositeUniform {
            origin,
            origin_dx,
            origin_dy,
            direction,
            direction_dx,
            direction_dy,
            clip,
            viewport,
            image,
            scale,
        }
    );
    assert_same_layout!(
        &DEPTH,
        &vec![("MULTISAMPLED", 0)],
        "Source",
        SourceUniform {
            view_z,
            view_w,
            viewport,
            layers,
        }
    );
    assert_same_layout!(
        &VIEW_DEPTH,
        &view_depth_defs(1),
        "ViewDepth",
        ViewDepthUniform { clip, place }
    );
    assert_same_layout!(
        &SETTLE,
        &Vec::new(),
        "Settle",
        SettleUniform { size, kept, most }
    );
}

fn view_depth_defs(slices: u32) -> ShaderDefs {
    let mut defs = with(&[
        ("SLICES", slices),
        ("TRANSFER_POINTS", 0),
        ("CLIP_PLANES", 8),
    ]);
    defs.push(("LEAST_OPACITY_PERCENT", 5));
    defs
}

fn validated(file: &ShaderFile, defs: &ShaderDefs) -> (naga::Module, ModuleInfo) {
    let module = match compose(file, defs) {
        Ok(module) => module,
        Err(error) => panic!("{defs:?}: {error}"),
    };
    // Unpacking halves needs no half arithmetic: every WebGPU device has it.
    let capabilities = Capabilities::SUBGROUP | Capabilities::SHADER_FLOAT16_IN_FLOAT32;
    let info = Validator::new(ValidationFlags::all(), capabilities)
        .validate(&module)
        .unwrap_or_else(|error| panic!("{}, {defs:?}: {error:?}", file.path));
    (module, info)
}

#[test]
fn every_variant_of_every_kernel_is_valid() {
    for defs in variants() {
        validated(&TRACE, &defs);
    }
    for mut defs in variants() {
        defs.extend(pass_defs(3));
        validated(&GUIDES, &defs);
    }
    for radius in [0, 3, 8] {
        let mut defs = with(&[]);
        defs.extend(pass_defs(radius));
        validated(&HOLOVOL, &defs);
        validated(&PAPER, &defs);
    }
    validated(&FETCH, &with(&[]));
    validated(&CONTRACT, &with(&[("SURFACE", 1)]));
    for flag in [0, 1] {
        validated(&MAJORANT, &vec![("CELL_SIZE", 8), ("SLICES", flag)]);
        validated(&DEPTH, &vec![("MULTISAMPLED", flag)]);
        validated(&VIEW_DEPTH, &view_depth_defs(flag));
    }
    for slices in [0, 1] {
        let changes = [("SAMPLE_SHARES", 1), ("MESH_DEPTH", 1), ("SLICES", slices)];
        validated(&TRACE, &with(&changes));
    }
    validated(&RESUME, &resume_defs());
    validated(&SETTLE, &Vec::new());
    validated(&COMPOSITE, &Vec::new());
}

fn bindings(module: &naga::Module) -> Vec<ResourceBinding> {
    let mut bindings: Vec<_> = module
        .global_variables
        .iter()
        .filter_map(|(_, variable)| variable.binding)
        .collect();
    bindings.sort();
    bindings
}

/// Vulkan, DirectX and Metal each take the kernels in their own language; whichever system the
/// tests run on, all three are written.
#[test]
fn kernels_translate_for_every_driver() {
    let everything = with(&[
        ("SURFACE", 1),
        ("EMISSION", 1),
        ("MULTIPLE_SCATTERING", 1),
        ("GUIDES", 1),
        ("STATISTICS", 1),
        ("SUBGROUPS", 1),
        ("MESH_DEPTH", 1),
        ("SAMPLE_SHARES", 1),
        ("LIGHT_GRID", 1),
        ("CLIP_PLANES", 8),
    ]);
    let slices = |slices| vec![("CELL_SIZE", 8), ("SLICES", slices)];
    let kernels = [
        (&TRACE, with(&[])),
        (&TRACE, everything),
        (&TRACE, with(&[("SLICES", 0), ("CONSTANT_ENVIRONMENT", 1)])),
        (&FETCH, with(&[])),
        (&MAJORANT, slices(0)),
        (&MAJORANT, slices(1)),
        (&DEPTH, vec![("MULTISAMPLED", 0)]),
        (&DEPTH, vec![("MULTISAMPLED", 1)]),
        (&RESUME, resume_defs()),
        (&SETTLE, Vec::new()),
    ];
    for (file, defs) in kernels {
        let (module, info) = validated(file, &defs);
        for entry in &module.entry_points {
            let at = format!("{}, {}", file.path, entry.name);
            to_spir_v(&module, &info, &entry.name)
                .unwrap_or_else(|error| panic!("{at}: SPIR-V: {error}"));
            to_hlsl(&module, &info, &entry.name)
                .unwrap_or_else(|error| panic!("{at}: HLSL: {error}"));
            to_msl(&module, &info, &entry.name)
                .unwrap_or_else(|error| panic!("{at}: MSL: {error}"));
        }
    }
}

fn to_spir_v(module: &naga::Module, info: &ModuleInfo, entry: &str) -> Result<(), String> {
    let options = naga::back::spv::Options {
        lang_version: (1, 3),
        ..Default::default()
    };
    let pipeline = naga::back::spv::PipelineOptions {
        shader_stage: ShaderStage::Compute,
        entry_point: entry.into(),
    };
    let words = naga::back::spv::write_vec(module, info, &options, Some(&pipeline));
    match words {
        Ok(words) if words.is_empty() => Err("nothing was written".into()),
        Ok(_) => Ok(()),
        Err(error) => Err(error.to_string()),
    }
}

fn to_hlsl(module: &naga::Module, info: &ModuleInfo, entry: &str) -> Result<(), String> {
    let options = naga::back::hlsl::Options {
        shader_model: naga::back::hlsl::ShaderModel::V6_0,
        ..Default::default()
    };
    let pipeline = naga::back::hlsl::PipelineOptions {
        entry_point: Some((ShaderStage::Compute, entry.into())),
    };
    let mut text = String::new();
    let written = naga::back::hlsl::Writer::new(&mut text, &options, &pipeline)
        .write(module, info, None)
        .map_err(|error| error.to_string())?;
    written.entry_point_names.into_iter().try_for_each(|name| {
        let name = name.map_err(|error| error.to_string())?;
        text.contains(&name)
            .then_some(())
            .ok_or(format!("no {name} in it"))
    })
}

fn to_msl(module: &naga::Module, info: &ModuleInfo, entry: &str) -> Result<(), String> {
    let options = naga::back::msl::Options {
        lang_version: (2, 4),
        fake_missing_bindings: true,
        ..Default::default()
    };
    let pipeline = naga::back::msl::PipelineOptions {
        entry_point: Some((ShaderStage::Compute, entry.into())),
        ..Default::default()
    };
    let (_, written) = naga::back::msl::write_string(module, info, &options, &pipeline)
        .map_err(|error| error.to_string())?;
    let name = written.entry_point_names.into_iter().next();
    name.ok_or("no entry point")?
        .map(|_| ())
        .map_err(|error| error.to_string())
}

const WITH_ALL_BINDINGS: &[(&str, u32)] = &[
    ("GUIDES", 1),
    ("MESH_DEPTH", 1),
    ("SAMPLE_SHARES", 1),
    ("LIGHT_GRID", 1),
];

/// WebGPU's defaults allow eight storage buffers and four storage textures, four of 64 KiB uniforms.
#[test]
fn bindings_are_dense_and_within_webgpus_limits() {
    let limits = wgpu::Limits::default();
    let kernels = [
        (&TRACE, with(WITH_ALL_BINDINGS)),
        (&MAJORANT, vec![("CELL_SIZE", 8), ("SLICES", 0)]),
    ];
    for (file, defs) in kernels {
        let (module, _) = validated(file, &defs);
        let bindings = bindings(&module);
        let expected =
            (0..bindings.len() as u32).map(|binding| ResourceBinding { group: 0, binding });
        assert_eq!(bindings, expected.collect::<Vec<_>>(), "{}", file.path);
        let count = |fits: &dyn Fn(&naga::GlobalVariable) -> bool| {
            module
                .global_variables
                .iter()
                .filter(|(_, v)| fits(v))
                .count() as u32
        };
        let storage = count(&|v| matches!(v.space, AddressSpace::Storage { .. }));
        assert!(
            storage <= limits.max_storage_buffers_per_shader_stage,
            "{storage}"
        );
        let is_storage_texture = |v: &naga::GlobalVariable| {
            matches!(
                module.types[v.ty].inner,
                naga::TypeInner::Image {
                    class: naga::ImageClass::Storage { .. },
                    ..
                }
            )
        };
        let textures = count(&is_storage_texture);
        assert!(
            textures <= limits.max_storage_textures_per_shader_stage,
            "{textures}"
        );
    }
}

/// Names of the bound variables, in the order in which Rust lists their types.
#[test]
fn bindings_keep_the_order_of_the_layouts() {
    let (module, _) = validated(&TRACE, &with(WITH_ALL_BINDINGS));
    let name = |wanted: u32| {
        let mut variables = module.global_variables.iter();
        variables.find_map(|(_, v)| match v.binding {
            Some(ResourceBinding { binding, .. }) if binding == wanted => v.name.clone(),
            _ => None,
        })
    };
    let names: Vec<_> = (0..bindings(&module).len() as u32)
        .filter_map(name)
        .collect();
    for (found, expected) in names.iter().zip(crate::trace::tests::BINDINGS) {
        assert!(
            found.starts_with(expected),
            "{found} where {expected} is bound"
        );
    }
    assert_eq!(names.len(), crate::trace::tests::BINDINGS.len());
}

/// Members of a struct by name, byte offset and size of the whole, as WGSL lays them out.
pub(crate) fn struct_layout(
    file: &ShaderFile,
    defs: &ShaderDefs,
    name: &str,
) -> (Vec<(String, u32)>, u32) {
    let (module, _) = validated(file, defs);
    let found = module.types.iter().find_map(|(_, ty)| {
        let matches = ty
            .name
            .as_deref()
            .is_some_and(|n| n.split("X_naga").next() == Some(name));
        match &ty.inner {
            naga::TypeInner::Struct { members, span } if matches => Some((members.clone(), *span)),
            _ => None,
        }
    });
    let (members, span) = found.unwrap_or_else(|| panic!("{} has no struct {name}", file.path));
    let members = members
        .into_iter()
        .map(|m| (m.name.unwrap_or_default(), m.offset));
    (members.collect(), span)
}

/// Asserts that a `repr(C)` struct has the members of a WGSL struct at their offsets.
macro_rules! assert_same_layout {
    ($file:expr, $defs:expr, $wgsl:literal, $rust:ty { $($field:ident),* $(,)? }) => {{
        let (members, span) = $crate::shader::tests::struct_layout($file, $defs, $wgsl);
        let rust = vec![$((stringify!($field).to_owned(), std::mem::offset_of!($rust, $field) as u32)),*];
        let padding = |name: &str| name.starts_with("padding");
        let wgsl: Vec<_> = members.into_iter().filter(|(name, _)| !padding(name)).collect();
        assert_eq!(rust, wgsl, $wgsl);
        assert_eq!(size_of::<$rust>() as u32, span, "size of {}", $wgsl);
    }};
}
pub(crate) use assert_same_layout;

pub(crate) fn plain() -> ShaderDefs {
    with(&[("GUIDES", 1)])
}

#[test]
fn a_mistake_is_an_error_that_names_the_file() {
    let file = ShaderFile {
        path: "broken.wgsl",
        source: "@compute @workgroup_size(1) fn f() { nothing(); }",
    };
    let error = compose(&file, &with(&[])).unwrap_err().to_string();
    assert!(error.contains("broken.wgsl"), "{error}");
}

#[test]
fn entry_points_are_those_that_pipelines_name() {
    let names = |file, defs: &ShaderDefs| -> Vec<String> {
        let (module, _) = validated(file, defs);
        module
            .entry_points
            .iter()
            .map(|entry| entry.name.clone())
            .collect()
    };
    assert_eq!(names(&TRACE, &with(&[])), ["trace", "resume"]);
    assert_eq!(names(&FETCH, &with(&[])), ["fetch"]);
    let defs = vec![("CELL_SIZE", 8), ("SLICES", 0)];
    assert_eq!(names(&MAJORANT, &defs), ["cell_range", "majorant"]);
    let (module, _) = validated(&TRACE, &with(&[]));
    let arguments = &module.entry_points[0].function.arguments;
    assert!(
        arguments
            .iter()
            .all(|a| matches!(a.binding, Some(Binding::BuiltIn(_))))
    );
}
