// Drives cranes as the page does: for each request, inputs at control instants.
// Returns where the crane is at the end, and rows for the columns if they are asked for; of the inputs of a
// file only why they are refused.
async function drive(data, requests) {
  const code = await compile(data.kernel);
  return requests.map(({file, inputs, instants, rows}) => {
    if (file !== undefined) return replayRefusal(data, file);
    const values = [];
    const began = performance.now();
    const run = replay(data, code, inputs, instants, rows ? each => values.push(each.values()) : undefined);
    const {q, v} = run.kernel;
    return {k: run.k, q: [...q], v: [...v], event: run.event, rows: values, task: run.task, assist: run.assist,
      utilisation: run.utilisation, tension: run.tension, swing: run.swing,
      seconds: (performance.now() - began) / 1000};
  });
}
