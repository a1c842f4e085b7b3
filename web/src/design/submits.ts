/** Return a form's handler that does `work` and leaves the page where it is. */
export const submits = (work: () => unknown) => (event: Event) => {
  event.preventDefault();
  void work();
};
