//! The elements that are read. Nobody's name, identifier, birth date or address is among them.

/// Group in the upper, element in the lower half.
pub(super) type Tag = u32;

macro_rules! tags {
    ($($name:ident = $tag:literal;)*) => {
        $(pub(super) const $name: Tag = $tag;)*

        /// Whether an element's value is kept.
        pub(super) fn wanted(tag: Tag) -> bool {
            matches!(tag, $($tag)|*)
        }
    };
}

tags! {
    TRANSFER_SYNTAX = 0x0002_0010;
    IMAGE_TYPE = 0x0008_0008;
    SOP_INSTANCE = 0x0008_0018;
    MODALITY = 0x0008_0060;
    SERIES_DESCRIPTION = 0x0008_103e;
    SLICE_THICKNESS = 0x0018_0050;
    ECHO_TIME = 0x0018_0081;
    SPACING_BETWEEN_SLICES = 0x0018_0088;
    MR_ECHO_SEQUENCE = 0x0018_9114;
    EFFECTIVE_ECHO_TIME = 0x0018_9082;
    B_VALUE = 0x0018_9087;
    MR_DIFFUSION_SEQUENCE = 0x0018_9117;
    SERIES_INSTANCE = 0x0020_000e;
    SERIES_NUMBER = 0x0020_0011;
    ACQUISITION_NUMBER = 0x0020_0012;
    INSTANCE_NUMBER = 0x0020_0013;
    POSITION = 0x0020_0032;
    ORIENTATION = 0x0020_0037;
    TEMPORAL_POSITION = 0x0020_0100;
    SLICE_LOCATION = 0x0020_1041;
    FRAME_CONTENT_SEQUENCE = 0x0020_9111;
    PLANE_POSITION_SEQUENCE = 0x0020_9113;
    PLANE_ORIENTATION_SEQUENCE = 0x0020_9116;
    TEMPORAL_POSITION_INDEX = 0x0020_9128;
    SAMPLES_PER_PIXEL = 0x0028_0002;
    PHOTOMETRIC = 0x0028_0004;
    NUMBER_OF_FRAMES = 0x0028_0008;
    ROWS = 0x0028_0010;
    COLUMNS = 0x0028_0011;
    PIXEL_SPACING = 0x0028_0030;
    BITS_ALLOCATED = 0x0028_0100;
    BITS_STORED = 0x0028_0101;
    HIGH_BIT = 0x0028_0102;
    PIXEL_REPRESENTATION = 0x0028_0103;
    PIXEL_PADDING = 0x0028_0120;
    PIXEL_PADDING_LIMIT = 0x0028_0121;
    WINDOW_CENTER = 0x0028_1050;
    WINDOW_WIDTH = 0x0028_1051;
    RESCALE_INTERCEPT = 0x0028_1052;
    RESCALE_SLOPE = 0x0028_1053;
    RESCALE_TYPE = 0x0028_1054;
    WINDOW_EXPLANATION = 0x0028_1055;
    VOI_FUNCTION = 0x0028_1056;
    MODALITY_LUT_SEQUENCE = 0x0028_3000;
    PIXEL_MEASURES_SEQUENCE = 0x0028_9110;
    FRAME_WINDOW_SEQUENCE = 0x0028_9132;
    PIXEL_TRANSFORM_SEQUENCE = 0x0028_9145;
    IMAGER_PIXEL_SPACING = 0x0018_1164;
    DETECTOR_SEQUENCE = 0x0054_0022;
    UNITS = 0x0054_1001;
    DOSE_UNITS = 0x3004_0002;
    GRID_FRAME_OFFSETS = 0x3004_000c;
    DOSE_GRID_SCALING = 0x3004_000e;
    SHARED_GROUPS = 0x5200_9229;
    FRAME_GROUPS = 0x5200_9230;
}

pub(super) const FLOAT_PIXEL_DATA: Tag = 0x7fe0_0008;
pub(super) const DOUBLE_PIXEL_DATA: Tag = 0x7fe0_0009;
pub(super) const PIXEL_DATA: Tag = 0x7fe0_0010;
pub(super) const ITEM: Tag = 0xfffe_e000;
pub(super) const ITEM_END: Tag = 0xfffe_e00d;
pub(super) const SEQUENCE_END: Tag = 0xfffe_e0dd;

/// The sequences among the wanted elements, for files that don't write an element's type.
pub(super) fn is_sequence(tag: Tag) -> bool {
    matches!(
        tag,
        MR_ECHO_SEQUENCE
            | MR_DIFFUSION_SEQUENCE
            | FRAME_CONTENT_SEQUENCE
            | PLANE_POSITION_SEQUENCE
            | PLANE_ORIENTATION_SEQUENCE
            | MODALITY_LUT_SEQUENCE
            | PIXEL_MEASURES_SEQUENCE
            | FRAME_WINDOW_SEQUENCE
            | PIXEL_TRANSFORM_SEQUENCE
            | DETECTOR_SEQUENCE
            | SHARED_GROUPS
            | FRAME_GROUPS
    )
}
