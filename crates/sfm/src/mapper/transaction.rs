use super::growth::Mapper;
use crate::Error;

impl Mapper<'_> {
    /// Does something that may fail: where it does, the solution is as it was before, and the error
    /// is the inner one. Only a request to stop is the outer one.
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
