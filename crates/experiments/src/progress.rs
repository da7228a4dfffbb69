use std::ops::ControlFlow;

use tiepoint_pipeline::Event;

/// Gets the progress of an experiment, in order and on the calling thread. `Break` stops the work.
pub trait Progress {
    /// An event of a stage.
    fn watch(&mut self, event: &Event) -> ControlFlow<()>;

    /// Step `number` of `total` begins.
    fn step(&mut self, number: usize, total: usize, what: &str);

    /// `image` is rendered next, after `done` of `total` images.
    fn rendering(&mut self, image: &str, done: usize, total: usize) -> ControlFlow<()>;
}
