function drone = connect(link, number)
%CONNECT Connect to a drone of the page's server.
%   drone = twodof.connect() connects to the first drone of `twodof up` on this
%   computer, or of the link in the environment variable TWODOF_LINK.
%   drone = twodof.connect(link) takes the link that the server prints; the
%   token in it is sent in a header.
%   drone = twodof.connect(link, number) takes the drone with this number (its
%   MAVLink system).
%   Errors: twodof:http, twodof:noDrone.
if nargin < 1 || isempty(link)
    link = getenv('TWODOF_LINK');
    if isempty(link)
        link = 'http://127.0.0.1:8080/';
    end
end
[address, query] = strtok(char(link), '?');
token = regexprep(query, '^\?token=', '');
if nargin < 2
    number = 0;
end
drone = twodof.Drone(regexprep(address, '/+$', ''), token, number);
end
