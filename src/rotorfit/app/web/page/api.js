// Requests to the studio. A refusal is an Error whose message is the one line of the server.

export class Refusal extends Error {
  constructor(status, message) { super(message); this.status = status; }
}

async function answered(response) {
  if (response.ok) return response;
  let line = `the studio answered ${response.status}; see its terminal for details`;
  try { line = (await response.json()).error || line; } catch { /* not JSON: a bug, told above */ }
  throw new Refusal(response.status, line);
}

export async function get(path) { return (await answered(await fetch(path))).json(); }

export async function send(method, path, body = {}) {
  const response = await fetch(path, {method, headers: {"content-type": "application/json"}, body: JSON.stringify(body)});
  return (await answered(response)).json();
}

export async function file(path) { // something to keep, with the name that the server gives it
  const response = await answered(await fetch(path));
  return {blob: await response.blob(), name: /filename="([^"]+)"/.exec(response.headers.get("content-disposition"))[1]};
}

export async function windowOf(path, from, to, width, signal) {
  const address = new URL(path, location.origin);
  if (from !== null) { address.searchParams.set("from", from); address.searchParams.set("to", to); }
  address.searchParams.set("width", Math.max(1, Math.round(width)));
  const response = await answered(await fetch(address, {signal}));
  const buffer = await response.arrayBuffer();
  const points = Number(response.headers.get("x-points"));
  const time = new Float64Array(buffer, 0, points), columns = [];
  for (let k = 0; 8 * points + 4 * points * (k + 1) <= buffer.byteLength && points; k++) {
    columns.push(Array.from(new Float32Array(buffer, 8 * points + 4 * points * k, points), v => Number.isNaN(v) ? null : v));
  }
  return {
    time, columns,
    exact: response.headers.get("x-exact") === "1",
    samples: Number(response.headers.get("x-samples")),
    whole: response.headers.get("x-whole").split(" ").map(Number),
  };
}

export function upload(file, progress) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", `/api/logs?name=${encodeURIComponent(file.name)}`);
    request.setRequestHeader("content-type", "application/octet-stream");
    request.upload.onprogress = event => progress(event.lengthComputable ? event.loaded / event.total : null);
    request.upload.onload = () => progress(1);
    request.onerror = () => reject(new Refusal(0, `${file.name}: the upload was broken off; is the studio still running?`));
    request.onload = () => {
      let answer = {};
      try { answer = JSON.parse(request.responseText); } catch { /* told below */ }
      if (request.status === 201) resolve(answer);
      else reject(new Refusal(request.status, answer.error || `${file.name}: the studio answered ${request.status}`));
    };
    request.send(file);
  });
}
