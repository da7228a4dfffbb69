//! Names of the files of a workspace that several stages and commands use.

/// Rig extrinsics of the largest model.
pub const RIG: &str = "rig.json";
/// Where the frame of the models is, if positions told.
pub(crate) const GEOREFERENCE: &str = "georeference.json";
/// Folder of the models.
pub const SPARSE: &str = "sparse";

/// Folder of the dense workspace.
pub(crate) const DENSE: &str = "dense";
/// The dense cloud.
pub(crate) const DENSE_CLOUD: &str = "dense/fused.ply";

/// The folder of a model, relative to the workspace.
pub fn model_path(index: usize) -> String {
    format!("{SPARSE}/{index}")
}

/// The file of a model's rig extrinsics, relative to the workspace: `rig.json` for the largest
/// model, `rig-1.json` for the next.
pub(crate) fn rig_name(index: usize) -> String {
    if index == 0 { RIG.to_owned() } else { format!("rig-{index}.json") }
}

/// Whether [`rig_name`] can give a name.
pub(crate) fn is_rig_name(name: &str) -> bool {
    let number = name.strip_prefix("rig-").and_then(|rest| rest.strip_suffix(".json"));
    name == RIG
        || number
            .and_then(|number| number.parse().ok())
            .is_some_and(|index| rig_name(index) == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rig_names_are_recognised() {
        assert!((0..20).all(|index| is_rig_name(&rig_name(index))));
        let others = [
            "rig-0.json",
            "rig-01.json",
            "rig-.json",
            "rig-a.json",
            "rig-1.json.bak",
            "rig",
            "rig-1",
        ];
        assert!(others.iter().all(|name| !is_rig_name(name)));
    }
}
