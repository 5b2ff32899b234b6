// Asking the service: commands, what is known, and the stream that begins anew when it is cut.

export class Refused extends Error {
  constructor(status, text) { super(text); this.status = status; }
}

async function answered(response) {
  if (response.ok) return response;
  let text = response.statusText;
  try {
    const { detail } = await response.json();
    text = typeof detail === "string" ? detail : detail.map((d) => `${d.loc.slice(-1)}: ${d.msg}`).join("; ");
  } catch { /* an answer without words */ }
  throw new Refused(response.status, text);
}

export async function get(path) {
  return (await answered(await fetch(path))).json();
}

export async function getBytes(path) {
  return (await answered(await fetch(path))).arrayBuffer();
}

export async function send(path, body, headers = {}, method = "POST") {
  const plain = body === undefined || body instanceof Blob;
  const kind = plain ? {} : { "Content-Type": "application/json" };
  const content = plain ? body : JSON.stringify(body);
  const response = await fetch(path, { method, body: content, headers: { "X-Fiberloom": "1", ...kind, ...headers } });
  return (await answered(response)).json();
}

const FIRST_MS = 300, LONGEST_MS = 4000;

// `before` is awaited before each connection, `begin` after it, before what came meanwhile is handed over.
export function stream({ before, begin, event, picture, cut }) {
  let wait = FIRST_MS;
  const again = () => {
    setTimeout(connect, wait);
    wait = Math.min(2 * wait, LONGEST_MS);
  };
  const connect = async () => {
    try { await before(); } catch { again(); return; }
    const socket = new WebSocket(`${location.origin.replace(/^http/, "ws")}/api/v1/stream`);
    socket.binaryType = "arraybuffer";
    let ready = false;
    const early = [];
    const take = (data) => (typeof data === "string" ? event(JSON.parse(data)) : picture(data));
    socket.onopen = async () => {
      try {
        await begin();
        ready = true;
        wait = FIRST_MS;
        early.splice(0).forEach(take);
      } catch { socket.close(); }
    };
    socket.onmessage = ({ data }) => (ready ? take(data) : early.push(data));
    socket.onclose = () => {
      cut();
      again();
    };
  };
  connect();
}
