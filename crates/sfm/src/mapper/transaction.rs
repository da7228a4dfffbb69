use super::refiner::Refiner;
use crate::Error;

impl Refiner<'_> {
    /// Runs `work` and restores the solution if it fails. The error of `work` is the inner one;
    /// [`Error::Cancelled`] is the outer one.
    pub(super) fn transaction<T>(
        &mut self,
        work: impl FnOnce(&mut Self) -> Result<T, Error>,
    ) -> Result<Result<T, Error>, Error> {
        let before = self.solution.clone();
        match work(self) {
            Err(Error::Cancelled) => Err(Error::Cancelled),
            Err(error) => {
                self.solution = before;
                Ok(Err(error))
            }
            Ok(done) => Ok(Ok(done)),
        }
    }
}
