/// TODO
pub struct AliasEntry;
/// TODO
pub struct EnvironmentSampler;
