# One image with the one binary; every node is `starmesh node ROLE`.
FROM rust:1.95-bookworm AS build
RUN apt-get update && apt-get install -y --no-install-recommends cmake && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY . .
RUN cargo build --release --locked --workspace

FROM debian:bookworm-slim
RUN useradd --system --create-home --home-dir /var/lib/starmesh starmesh
COPY --from=build /src/target/release/starmesh /usr/local/bin/starmesh
USER starmesh
WORKDIR /var/lib/starmesh
ENTRYPOINT ["starmesh"]
