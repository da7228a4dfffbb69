/// Why a drive was not rendered or an experiment failed. A message is one sentence: what, where,
/// what to do.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Options that no drive can have.
    #[error("{0}")]
    Usage(String),
    /// The output folder is somebody else's, or cannot be read or written.
    #[error("{0}")]
    Folder(String),
    /// A stage failed or was stopped.
    #[error(transparent)]
    Pipeline(#[from] tiepoint_pipeline::Error),
    /// A drive cannot be made or written.
    #[error(transparent)]
    Synth(#[from] tiepoint_synth::Error),
    /// A model or a depth map cannot be written.
    #[error(transparent)]
    File(#[from] tiepoint_pipeline::io::Error),
    /// A table or a record cannot be written.
    #[error(transparent)]
    Store(#[from] tiepoint_pipeline::store::Error),
}
